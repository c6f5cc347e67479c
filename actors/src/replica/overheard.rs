//! What voters say to one another, read as they read it, for those who try that with bytes of their own.

use super::canvass::Canvass;
use super::network::{Answer, Beat, Presence, read_answer};
use super::serve::read_question;
use super::store::{Kept, read_record, write_record};
use super::succession::Succession;
use super::types::{RaftId, StateMachine, Types};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::keys::RaftCall;
use openraft::Entry;
use openraft::raft::{
    AppendEntriesRequest, AppendEntriesResponse, InstallSnapshotRequest, InstallSnapshotResponse, VoteRequest,
    VoteResponse,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io;

/// Reads a question as the voter does that is asked, and writes it again.
pub(crate) fn question<S: StateMachine>(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fn again<T: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
        read_question::<T>(bytes).and_then(|question| codec::encode(&question))
    }
    match call {
        RaftCall::Vote => again::<VoteRequest<RaftId>>(bytes),
        RaftCall::Append => again::<AppendEntriesRequest<Types<S>>>(bytes),
        RaftCall::Snapshot => again::<InstallSnapshotRequest<Types<S>>>(bytes),
        RaftCall::Canvass => again::<Canvass>(bytes),
        RaftCall::Succeed => {
            let (asker, word) = read_question::<Succession>(bytes)?;
            // What it would have the voter do is reckoned from it at once.
            let _ = word.gives();
            codec::encode(&(asker, word))
        }
        RaftCall::Beat => again::<Beat>(bytes),
    }
}

/// Reads an answer as the voter does that has asked, and writes it again.
pub(crate) fn answer(call: RaftCall, bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
    fn again<A: Serialize + DeserializeOwned>(bytes: &[u8]) -> Result<Vec<u8>, CodecError> {
        read_answer::<A>(bytes).and_then(|answer: Answer<A>| codec::encode(&answer))
    }
    match call {
        RaftCall::Vote => again::<VoteResponse<RaftId>>(bytes),
        RaftCall::Append => again::<AppendEntriesResponse<RaftId>>(bytes),
        RaftCall::Snapshot => again::<InstallSnapshotResponse<RaftId>>(bytes),
        RaftCall::Canvass | RaftCall::Succeed => again::<bool>(bytes),
        RaftCall::Beat => again::<Presence>(bytes),
    }
}

/// Reads an entry of the log as it is on the disk, and writes it again.
pub(crate) fn entry<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    write_record(&read_record::<Entry<Types<S>>>(bytes)?)
}

/// Reads a snapshot as it is on the disk, or as its pieces came from a leader, with the state in it, and writes it again.
pub(crate) fn snapshot<S: StateMachine>(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let kept: Kept = read_record(bytes)?;
    let state: S = read_record(&kept.state)?;
    write_record(&Kept { state: write_record(&state)?, ..kept })
}
