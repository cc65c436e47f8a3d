"""What is wrong with a drop before it is inverted, and what of it can be used."""
