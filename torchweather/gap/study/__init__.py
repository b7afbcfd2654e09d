"""Study: scenes and conditions, the folder that holds them, recorded and simulated frames."""
