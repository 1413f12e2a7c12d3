"""The C core: the plan of the codec, and the ordered publishing and taking of slots."""
