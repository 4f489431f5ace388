"""How images are taken: patterns, their basis, and the sensor."""
