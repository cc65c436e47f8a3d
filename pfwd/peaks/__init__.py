"""What peaks alone say: peak and surface moduli, basin indices, stiffness of a rig."""
