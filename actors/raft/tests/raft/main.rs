//! Replicated ledger on the virtual bus.

mod failover;
mod group_commit;
mod leadership_transfer;
mod ledger;
mod log_limit;
mod lost_leaders;
mod slow_links;
mod snapshots;
mod support;
