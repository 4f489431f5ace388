"""Circuit boards with solder paste: layouts, Gerber files, prints and their defects, surfaces."""
