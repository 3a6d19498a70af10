"""The designer's chart: an A4 page over mass ratio and frequency ratio, for a design's rock and drive."""
