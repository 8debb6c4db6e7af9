"""Labs as they run: the live feed of what is recorded, and the pure model that screens are drawn from."""
