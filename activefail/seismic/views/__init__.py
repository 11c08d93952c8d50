"""How a simulated bearing is shown on pages."""
