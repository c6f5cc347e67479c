//! Held to the published formats of `rmw_zenoh`, `rosidl` and `nav2_msgs`, and tried from end to end on loopback.

mod formats;
mod graph;
mod nav2;
mod program;
mod robots;
mod support;
mod type_hashes;
