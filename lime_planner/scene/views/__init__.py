"""What cameras have seen of a plant: how far each of them saw, and the space that none of them shows."""
