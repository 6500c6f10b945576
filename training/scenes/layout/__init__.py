"""Layout of a scene: the street, its traffic, houses, furniture and markings."""
