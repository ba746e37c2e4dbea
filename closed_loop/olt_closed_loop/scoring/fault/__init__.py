"""Who was at fault for a contact: rules by name, what a defensive driver could have done, and whose lane it was."""
