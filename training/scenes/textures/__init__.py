"""How surfaces look close by: colour, gloss and what is painted on them."""
