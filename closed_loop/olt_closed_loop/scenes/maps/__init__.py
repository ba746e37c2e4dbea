"""Roads with topology: lanes, what regulates them, layouts by parameters, and questions asked of them."""
