"""One module per box of the figure, named after it, with all its variants and their configs."""
