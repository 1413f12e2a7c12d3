"""``rosplc-bench``: ways to exchange data with a PLC, compared on the user's own machine."""
