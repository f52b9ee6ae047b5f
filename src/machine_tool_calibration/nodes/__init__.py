# SPDX-License-Identifier: Apache-2.0
"""The rclpy nodes; each is a program of its own.

Names in the graph are relative, so a namespace or a remapping moves all of them; msg_docs/ describes every topic.
"""
