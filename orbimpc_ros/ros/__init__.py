# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""ROS 2 adapters: conversion of messages and parameters, and the two nodes."""
