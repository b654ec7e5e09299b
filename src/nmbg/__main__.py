"""`python -m nmbg`, which is how torchrun starts a module."""

from nmbg.cli import main

main()
