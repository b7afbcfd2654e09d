"""Light of lamps at night: in the air, on falling particles, and around the lamps themselves."""
