"""`arena dataset`: what others learn from."""
