# SPDX-License-Identifier: Apache-2.0
"""Recordings: MCAP bags in rosbag2's layout, written and read without ROS."""
