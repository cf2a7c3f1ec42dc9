"""The package version, alone, so that the build can read it without importing Drake."""

__version__ = "0.6.0"
