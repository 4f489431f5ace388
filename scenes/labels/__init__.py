"""Labels of solder paste: the truth of every pad, and COCO annotations."""
