"""Coarse finite elements, for tests that do not depend on the accuracy of the motion."""

from simulators.mesh import Resolution

COARSE = Resolution(
    edge_element=0.05,
    elements_per_wavelength=1.5,
    highest_frequency=2.0,
    undamped_wavelengths=0.25,
    damped_wavelengths=0.5,
)
