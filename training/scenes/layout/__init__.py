"""Where things stand: the street, its traffic, houses, furniture and markings."""
