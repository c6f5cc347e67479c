//! A replicated ledger on the virtual bus.

mod gathering;
mod ledger;
mod succession;
mod support;
mod takeover;
