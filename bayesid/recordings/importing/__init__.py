"""Files of other tools: read as they are, their columns found, converted to SI units and brought to one clock."""
