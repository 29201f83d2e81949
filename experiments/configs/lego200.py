"""A NeRF-synthetic scene with RGBA images; random backgrounds and supervised coverage keep its surroundings empty."""

CONFIG: dict = {"background": "random"}
