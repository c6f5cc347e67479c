//! Comparison with the published formats of `rmw_zenoh`, `rosidl` and `nav2_msgs`, and end-to-end
//! tests on loopback.

mod formats;
mod graph;
mod nav2;
mod program;
mod robots;
mod support;
mod type_hashes;
