"""Ground of the library: errors and checks, random streams, threads, distributions. Imports nothing else of it."""
