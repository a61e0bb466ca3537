"""What an identified robot is handed on as: models of simulators, code for controllers, ranges for learning."""
