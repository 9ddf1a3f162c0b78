"""From a scene to what its cameras record: small tasks that any process may do, in any order that they allow, and that leave nothing half-written."""
