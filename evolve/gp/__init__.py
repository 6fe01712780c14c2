"""Tree genetic programming: genotypes, their growth and their variation."""
