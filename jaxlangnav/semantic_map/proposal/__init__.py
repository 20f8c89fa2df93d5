"""The proposal for groundings of an utterance (section 3.2, eq. 7a)."""
