"""Everything that comes in is checked here: files, numbers, names, types of objects."""
