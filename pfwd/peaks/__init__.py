"""Moduli and deflection-basin indices from peak values alone, and the stiffness of a spring test
rig.
"""
