# SPDX-License-Identifier: Apache-2.0
"""The rclpy nodes, each a program of its own; names in the graph are relative, and described in msg_docs/."""
