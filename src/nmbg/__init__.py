"""Novel views of a real scene from ordinary photographs, by neural rendering of a mesh."""

__version__ = "0.1.0"
