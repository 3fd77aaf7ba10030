"""Proofs as data: certificates of lower bounds, and a verifier that shares nothing with methods."""
