"""Studies: one file per question that a notebook or a page of results asks."""
