"""`arena dataset` and `arena task`: what others learn from, and are compared on."""
