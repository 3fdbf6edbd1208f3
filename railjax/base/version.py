"""The release of railjax, which results and stores name."""

__version__ = "0.6.0"
