"""The formats of others, one room a world, each with its way in and its way out."""
