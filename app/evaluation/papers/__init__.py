"""The protocols of the papers that the matchers come from, on recorded fields."""
