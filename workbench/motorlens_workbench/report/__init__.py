"""What the commands found, as pages that open without a network, as tables for the terminal and as JSON."""
