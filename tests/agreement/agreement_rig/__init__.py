"""The same scenarios through netem, air and the pure medium, and whether their statistics agree."""
