"""A small capture made inside the program: shapes → appearance → photographs in a COLMAP workspace."""
