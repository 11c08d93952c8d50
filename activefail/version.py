"""The version of activefail."""

__version__ = "0.3.0"
