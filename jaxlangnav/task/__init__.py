"""A task: a sentence followed in a world, and judged by what it means there."""
