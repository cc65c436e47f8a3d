"""Moduli and deflection-basin indices from peak values, and the stiffness of a test rig."""
