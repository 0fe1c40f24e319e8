"""Tools of a checkout, no part of the product: the verbs of `dev.py`, and figures of pages."""
