//! Auctions: the bids for each role, and the reason of the assignment.

use super::state::{AuctionModel, RoleBid};
use super::{FleetModel, bounds};
use consort_protocol::auction::{AuctionEntry, AuctionRecord, Bid, BidPart, BidVerdict};
use consort_protocol::view::AuctionsView;

/// Maximum number of bids kept for an open auction of a mission.
const BIDS_MAX: usize = 512;

/// Maximum number of missions with open auctions.
const OPEN_AUCTIONS_MAX: usize = 64;

/// Returns the parts of a bid: as received, else from the record.
fn parts(entry: &AuctionEntry, received: Option<&Bid>) -> Option<Vec<BidPart>> {
    let parts = received.map_or(&entry.parts, |bid| &bid.parts);
    let known = received.is_some() || !parts.is_empty();
    known.then(|| parts.clone())
}

impl FleetModel {
    pub(super) fn apply_auctions(&mut self, view: &AuctionsView) {
        view.auctions.iter().for_each(|auction| self.apply_auction_record(&auction.record));
    }

    /// Opens a round: bids of former rounds are discarded.
    pub(super) fn open_auction(&mut self, mission: &str) {
        self.open_bids.insert(mission.to_owned(), vec![]);
        while self.open_bids.len() > OPEN_AUCTIONS_MAX {
            self.open_bids.pop_first();
        }
    }

    pub(super) fn add_bid(&mut self, mission: &str, bid: &Bid) {
        let bids = self.open_bids.entry(mission.to_owned()).or_default();
        if bids.len() < BIDS_MAX {
            bids.push(bid.clone());
        }
    }

    pub(super) fn apply_auction_record(&mut self, record: &AuctionRecord) {
        let mission = record.auction.mission.as_str();
        // Rounds are ordered by mission, term and round; missions are dropped by closing time.
        let name = format!("{mission}#{}.{}", record.auction.term, record.auction.round);
        // Only the bids themselves contain the start place.
        let has_received_bids = |shown: &AuctionModel| shown.offers.iter().any(|offer| offer.from.is_some());
        if self.auctions.get(&name).is_some_and(has_received_bids) {
            return;
        }
        let bids = self.open_bids.get(mission).map_or(&[][..], Vec::as_slice);
        let offers = record.entries.iter().map(|entry| {
            let bid = bids.iter().rfind(|bid| bid.robot == entry.robot && bid.role == entry.role);
            let mut offer = RoleBid {
                role: entry.role.to_string(),
                robot: entry.robot.to_string(),
                chosen: record.chosen.get(&entry.role) == Some(&entry.robot),
                from: bid.map(|bid| bid.from.to_string()),
                parts: parts(entry, bid),
                ..RoleBid::default()
            };
            let (word, price, why) = match &entry.verdict {
                BidVerdict::Viable { time, energy, remaining } => ("bid", Some((time, energy, remaining)), None),
                BidVerdict::Unviable { time, energy, remaining, why } => {
                    ("unviable", Some((time, energy, remaining)), Some(why.to_string()))
                }
                BidVerdict::Refused { reason } => ("refused", None, Some(reason.to_string())),
                BidVerdict::NotAsked { reason, .. } => {
                    let robots = entry.robots().count();
                    ("not_asked", None, Some(format!("one of {robots}: {reason}")))
                }
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
