"""Schemas that a user gives a topic: protobuf messages and JSON Schemas, against which each row is checked."""
