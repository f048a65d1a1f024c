"""Plan the reach of a harvesting arm to a fruit inside a plant: around its stems and through as few leaves as it must."""

__version__ = "0.1.0"
