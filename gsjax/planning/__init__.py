"""What will run: how large, how long, on which devices, with which effects."""
