"""How good a result is: images, geometry, and the protocols of published benchmarks."""
