//! Commands of the ledger.

use super::frames::frames;
use consort_protocol::codec;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, CommandOutcome, Ledger};

/// The ledger survives any committed commands: a rejected command changes nothing, and the ledger
/// can be inspected, written and read back.
pub(super) fn ledger(bytes: &[u8]) -> bool {
    let (mut ledger, mut applied) = (Ledger::default(), 0);
    for (index, (_, piece)) in (1..).zip(frames(bytes).take(40)) {
        let Ok(command) = codec::decode::<Command>(piece) else { continue };
        let before = written(&ledger);
        let outcome = ledger.apply(Epoch { term: 1, index }, command);
        if let CommandOutcome::Refused(refused) = &outcome {
            assert!(written(&ledger) == before, "a refused command has changed the ledger: {refused}");
        } else {
            applied += 1;
        }
        codec::encode(&outcome).expect("an outcome fits a message");
        check_ledger(&ledger);
    }
    let whole = written(&ledger);
    let again: Ledger = codec::decode_record(&whole).expect("what was written can be read");
    assert!(written(&again) == whole, "it reads back as something else");
    applied > 0
}

fn written(ledger: &Ledger) -> Vec<u8> {
    codec::encode_record(ledger).expect("a small ledger")
}

fn check_ledger(ledger: &Ledger) {
    ledger.held_items().for_each(drop);
    for entry in ledger.active_missions() {
        entry.rank();
    }
    for entry in ledger.missions() {
        entry.custody();
        entry.holders();
        entry.progress();
        entry.open_roles();
        entry.state.as_str();
        for (role, holding) in entry.role_holders() {
            entry.signals_to(&role);
            entry.plan(&role);
            entry.excluded(&role);
            ledger.held_by(&holding.robot);
        }
    }
}
