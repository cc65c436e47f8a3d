"""Results from peaks without time histories: moduli, basin indices, stiffness of a rig."""
