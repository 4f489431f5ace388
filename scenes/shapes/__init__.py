"""Bodies and surfaces: solids, height fields, grains of powder, materials."""
