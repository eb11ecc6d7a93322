"""Flight: vehicle model, control, navigation, and what simulators have to offer."""
