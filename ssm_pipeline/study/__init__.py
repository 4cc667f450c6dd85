"""Studies: their settings, the YAML that holds the settings, and the cases they name."""
