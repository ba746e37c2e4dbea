"""The commands of this package: `olt mix` and `olt data`."""
