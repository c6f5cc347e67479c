//! Signed messages on the virtual bus, with real certificates and signatures: valid messages are
//! delivered, and forged or unauthorized messages are rejected.

mod certificates;
mod client_messages;
mod fixture;
mod messages;
mod requests;
mod tokens;
