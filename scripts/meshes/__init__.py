"""The objects of the playroom as meshes, made of primitives by code."""
