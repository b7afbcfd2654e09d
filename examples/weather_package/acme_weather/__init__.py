"""Names of our own for torchweather. Keep this file small: any of the names imports it."""
