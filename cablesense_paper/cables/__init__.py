"""One metre of cable in MuJoCo, as sections II-A to II-E study it, and its closed forms."""
