"""The version of the package, for whoever writes it down; imports nothing."""

__version__ = "0.1.0"
