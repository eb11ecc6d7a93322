"""The thesis's figures and numbers, made anew."""
