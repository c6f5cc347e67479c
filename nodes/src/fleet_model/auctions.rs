//! Auctions: what was offered for each role, and why the winner won.

use super::state::{AuctionModel, RoleBid};
use super::update::list;
use super::{FleetModel, bounds};
use consort_protocol::auction::{AuctionEntry, AuctionRecord, Bid, BidVerdict};
use serde_json::Value;

/// Bids kept of a mission whose auction is open.
const TENDERS: usize = 512;

/// Missions whose open auctions are kept.
const OPEN: usize = 64;

/// The parts of a bid: as it was heard, else as the record has them.
fn parts(entry: &AuctionEntry, heard: Option<&Bid>) -> Option<Value> {
    let parts = heard.map_or(&entry.parts, |bid| &bid.parts);
    let known = heard.is_some() || !parts.is_empty();
    known.then(|| serde_json::to_value(parts).ok()).flatten()
}

impl FleetModel {
    pub(super) fn apply_auctions(&mut self, view: &Value) {
        list(&view["auctions"]).for_each(|record| self.apply_auction(record));
    }

    pub(super) fn apply_auction(&mut self, record: &Value) {
        if let Ok(record) = serde_json::from_value::<AuctionRecord>(record.clone()) {
            self.apply_auction_record(&record);
        }
    }

    /// Members were asked: what was bid before is of no interest any more.
    pub(super) fn open_auction(&mut self, mission: &str) {
        self.open_bids.insert(mission.to_owned(), vec![]);
        while self.open_bids.len() > OPEN {
            self.open_bids.pop_first();
        }
    }

    pub(super) fn add_bid(&mut self, mission: &str, bid: &Bid) {
        let tenders = self.open_bids.entry(mission.to_owned()).or_default();
        if tenders.len() < TENDERS {
            tenders.push(bid.clone());
        }
    }

    pub(super) fn apply_auction_record(&mut self, record: &AuctionRecord) {
        let mission = record.auction.mission.as_str();
        // In the order in which they came: of missions by when they were closed.
        let name = format!("{mission}#{}.{}", record.auction.term, record.auction.round);
        // Only the bids themselves say where they start.
        let bids_heard = |shown: &AuctionModel| shown.offers.iter().any(|offer| offer.from.is_some());
        if self.auctions.get(&name).is_some_and(bids_heard) {
            return;
        }
        let tenders = self.open_bids.get(mission).map_or(&[][..], Vec::as_slice);
        let offers = record.entries.iter().map(|entry| {
            let tender = tenders.iter().rfind(|bid| bid.robot == entry.robot && bid.role == entry.role);
            let mut offer = RoleBid {
                role: entry.role.to_string(),
                robot: entry.robot.to_string(),
                chosen: record.chosen.get(&entry.role) == Some(&entry.robot),
                from: tender.map(|bid| bid.from.to_string()),
                parts: parts(entry, tender),
                ..RoleBid::default()
            };
            let (word, price, why) = match &entry.verdict {
                BidVerdict::Viable { time, energy, remaining } => ("bid", Some((time, energy, remaining)), None),
                BidVerdict::Unviable { time, energy, remaining, why } => {
                    ("unviable", Some((time, energy, remaining)), Some(why.to_string()))
                }
                BidVerdict::Refused { reason } => ("refused", None, Some(reason.to_string())),
            };
            word.clone_into(&mut offer.verdict);
            offer.why = why;
            if let Some((time, energy, remaining)) = price {
                (offer.time_s, offer.energy, offer.remaining) = (Some(time.get()), Some(*energy), Some(*remaining));
            }
            offer
        });
        let shown = AuctionModel {
            mission: mission.to_owned(),
            term: record.auction.term,
            round: u64::from(record.auction.round),
            at_ms: record.at_ms,
            chosen: record.chosen.iter().map(|(role, robot)| (role.to_string(), robot.to_string())).collect(),
            failure: record.failure.clone(),
            omitted: u64::from(record.omitted),
            offers: offers.collect(),
        };
        self.auctions.insert(name, shown);
        while self.auctions.len() > bounds::AUCTIONS {
            let oldest = self.auctions.iter().min_by_key(|(name, shown)| (shown.at_ms, (*name).clone()));
            let Some(oldest) = oldest.map(|(name, _)| name.clone()) else { break };
            self.auctions.remove(&oldest);
        }
    }
}
