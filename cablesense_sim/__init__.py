"""The arm in simulation: description, mechanism, kinematics, equilibrium, dynamics and sensors."""
