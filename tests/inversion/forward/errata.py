"""What the proofs of the misprints in docs/errata.md share.

Each test states the equation twice, as printed and as corrected, and decides between the two by
something that is neither: the equations of motion, a direct solution of the boundary conditions,
quadrature, or the paper's own tables. "As printed" is the text extracted from the published PDF.
Equation numbers are those of doi 10.11835/j.issn.2096-6717.2022.021.
"""

RADIUS = 0.15
DENSITY = 2000.0
POISSON_RATIO = 0.35
PEAK_PRESSURE = 142e3  # 10.04 kN on the plate
PULSE_DURATION = 0.0133
