"""The one place of the version; both distributions and everything that tells who made it read it here."""

__version__ = "0.2.0"
