"""The instrument's data sheet: design values, layout of its sensors, and their kinematics."""
