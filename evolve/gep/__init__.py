"""Gene expression programming: chromosomes, their operators and the engine that breeds with them."""
