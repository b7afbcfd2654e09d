"""A LiDAR of our own: plain values, a preset to start from, and where the numbers come from."""

ACME_32 = {
    "preset": "velodyne-hdl-32e",
    "range_noise_m": 0.03,
    "source": "ACME data sheet 7, table 2; the rest as of the Velodyne HDL-32E.",
}
