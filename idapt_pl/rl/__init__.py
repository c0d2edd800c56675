"""Acting in environments: policies, exploration, collecting, experience for replay, returns, experts."""
