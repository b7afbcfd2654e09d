"""The study: frames of a sensor in clear air and in weather, checked, diagnosed and compared."""
