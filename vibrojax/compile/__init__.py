"""From functions of lanes to machine code."""
