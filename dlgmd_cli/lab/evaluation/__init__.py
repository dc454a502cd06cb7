"""How well alarms announce labelled collisions, and which parameters do it best."""
