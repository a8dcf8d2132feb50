"""What `palpate doctor` looks at before a session, on real parts: one module a part, one function a check or a few."""
