//! A world for robots to act in, behind the robot-actions interface.
