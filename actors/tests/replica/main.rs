//! A replicated ledger on the virtual bus.

mod ledger;
mod succession;
mod support;
mod takeover;
