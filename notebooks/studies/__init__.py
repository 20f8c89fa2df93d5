"""What the notebooks ask of the belief: one file per question, held by the tests."""
