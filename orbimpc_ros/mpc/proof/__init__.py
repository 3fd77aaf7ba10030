# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proofs as data: certificates of lower bounds, and a verifier independent of the solvers."""
