//! Archive of a station: what the ledger forgets.
//!
//! ```text
//!  ledger ── ended missions, audit trail ──▶ follow ──▶ records ──▶ data directory/archive/2026-11-27-0001.jsonl, …
//!  events ── auctions, tasks ─────────────▶                               │
//!                                                                         └──▶ consort history export
//! ```
//!
//! Each station that keeps an archive writes all records, so the loss of a station loses none. The files are append-only
//! and ordered by time. The earliest are removed by age and by size. They can be read while the station writes.

mod files;
mod follow;
mod position;
mod record;

pub(crate) use files::{ArchiveFiles, FOLDER, read_all};
pub(crate) use follow::follow;
pub(crate) use record::{ArchiveKind, ArchiveRecord, CSV_HEADER};
