"""Studies: one file per question that a page of results asks."""
