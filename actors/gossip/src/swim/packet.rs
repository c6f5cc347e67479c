//! Encoding of failure detection packets: fixed layouts, big-endian, names preceded by their
//! length.
//!
//! foca combines several such values in a packet and encodes each separately, which the codec of
//! whole messages does not support.

use bytes::{Buf, BufMut};
use consort_protocol::ids::NodeId;
use foca::{Codec, Header, Member, Message, State};

/// Identity of a node for the failure detector: an address with a single live incarnation at a
/// time.
#[derive(Debug, Clone)]
pub(crate) struct SwimId {
    pub(super) node: NodeId,
    /// Incarnation of the node: that of its record. A start and a rejoin each create a later one.
    pub(super) incarnation: u64,
    /// Number of rejoins after a wrong down verdict; no part of the identity.
    pub(super) rejoins: u32,
}

impl PartialEq for SwimId {
    fn eq(&self, other: &SwimId) -> bool {
        (&self.node, self.incarnation) == (&other.node, other.incarnation)
    }
}

impl Eq for SwimId {}

impl SwimId {
    /// Returns the lowest identity of a node, sufficient to announce to a node known only by name.
    pub(super) fn lowest(node: NodeId) -> SwimId {
        SwimId { node, incarnation: 0, rejoins: 0 }
    }

    fn size(&self) -> usize {
        1 + self.node.as_str().len() + 8 + 4
    }
}

impl foca::Identity for SwimId {
    type Addr = NodeId;

    fn renew(&self) -> Option<SwimId> {
        let incarnation = self.incarnation.checked_add(1)?;
        Some(SwimId { incarnation, rejoins: self.rejoins.saturating_add(1), ..self.clone() })
    }

    fn addr(&self) -> NodeId {
        self.node.clone()
    }

    fn win_addr_conflict(&self, other: &SwimId) -> bool {
        self.incarnation > other.incarnation
    }
}

/// A packet cannot be read or written. Nothing was changed.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum PacketError {
    /// Expected: foca sends as much as fits.
    #[error("no room left in the packet")]
    BufferFull,
    /// Another program writes on the fleet's keys.
    #[error("packet ends too early")]
    Truncated,
    /// Written by another program, as above.
    #[error("packet has no valid {0} where expected")]
    Invalid(&'static str),
}

#[derive(Debug, Clone, Copy)]
pub(super) struct PacketCodec;

fn put_id(id: &SwimId, buf: &mut impl BufMut) {
    let name = id.node.as_str().as_bytes();
    buf.put_u8(u8::try_from(name.len()).expect("a node's name has at most 64 bytes"));
    buf.put_slice(name);
    buf.put_u64(id.incarnation);
    buf.put_u32(id.rejoins);
}

fn need(buf: &impl Buf, bytes: usize) -> Result<(), PacketError> {
    if buf.remaining() < bytes { Err(PacketError::Truncated) } else { Ok(()) }
}

fn get_u8(buf: &mut impl Buf) -> Result<u8, PacketError> {
    need(buf, 1)?;
    Ok(buf.get_u8())
}

fn get_u16(buf: &mut impl Buf) -> Result<u16, PacketError> {
    need(buf, 2)?;
    Ok(buf.get_u16())
}

fn get_id(buf: &mut impl Buf) -> Result<SwimId, PacketError> {
    let length = usize::from(get_u8(buf)?);
    need(buf, length + 12)?;
    let mut name = vec![0; length];
    buf.copy_to_slice(&mut name);
    let name = String::from_utf8(name).map_err(|_| PacketError::Invalid("name"))?;
    let node = NodeId::new(name).map_err(|_| PacketError::Invalid("name"))?;
    Ok(SwimId { node, incarnation: buf.get_u64(), rejoins: buf.get_u32() })
}

/// Returns the parts of a message: its number, the member and the probe that it concerns.
fn parts(message: &Message<SwimId>) -> (u8, Option<&SwimId>, Option<u8>) {
    match message {
        Message::Ping(probe) => (0, None, Some(*probe)),
        Message::Ack(probe) => (1, None, Some(*probe)),
        Message::PingReq { target, probe_number } => (2, Some(target), Some(*probe_number)),
        Message::IndirectPing { origin, probe_number } => (3, Some(origin), Some(*probe_number)),
        Message::IndirectAck { target, probe_number } => (4, Some(target), Some(*probe_number)),
        Message::ForwardedAck { origin, probe_number } => (5, Some(origin), Some(*probe_number)),
        Message::Announce => (6, None, None),
        Message::Feed => (7, None, None),
        Message::Gossip => (8, None, None),
        Message::Broadcast => (9, None, None),
        Message::TurnUndead => (10, None, None),
    }
}

fn get_message(buf: &mut impl Buf) -> Result<Message<SwimId>, PacketError> {
    Ok(match get_u8(buf)? {
        0 => Message::Ping(get_u8(buf)?),
        1 => Message::Ack(get_u8(buf)?),
        2 => Message::PingReq { target: get_id(buf)?, probe_number: get_u8(buf)? },
        3 => Message::IndirectPing { origin: get_id(buf)?, probe_number: get_u8(buf)? },
        4 => Message::IndirectAck { target: get_id(buf)?, probe_number: get_u8(buf)? },
        5 => Message::ForwardedAck { origin: get_id(buf)?, probe_number: get_u8(buf)? },
        6 => Message::Announce,
        7 => Message::Feed,
        8 => Message::Gossip,
        9 => Message::Broadcast,
        10 => Message::TurnUndead,
        _ => return Err(PacketError::Invalid("message")),
    })
}

impl Codec<SwimId> for PacketCodec {
    type Error = PacketError;

    fn encode_header(&mut self, header: &Header<SwimId>, mut buf: impl BufMut) -> Result<(), PacketError> {
        let (number, member, probe) = parts(&header.message);
        let size = header.src.size()
            + 2
            + header.dst.size()
            + 1
            + member.map_or(0, SwimId::size)
            + usize::from(probe.is_some());
        if buf.remaining_mut() < size {
            return Err(PacketError::BufferFull);
        }
        put_id(&header.src, &mut buf);
        buf.put_u16(header.src_incarnation);
        put_id(&header.dst, &mut buf);
        buf.put_u8(number);
        if let Some(id) = member {
            put_id(id, &mut buf);
        }
        if let Some(probe) = probe {
            buf.put_u8(probe);
        }
        Ok(())
    }

    fn decode_header(&mut self, mut buf: impl Buf) -> Result<Header<SwimId>, PacketError> {
        Ok(Header {
            src: get_id(&mut buf)?,
            src_incarnation: get_u16(&mut buf)?,
            dst: get_id(&mut buf)?,
            message: get_message(&mut buf)?,
        })
    }

    fn encode_member(&mut self, member: &Member<SwimId>, mut buf: impl BufMut) -> Result<(), PacketError> {
        if buf.remaining_mut() < member.id().size() + 3 {
            return Err(PacketError::BufferFull);
        }
        put_id(member.id(), &mut buf);
        buf.put_u16(member.incarnation());
        buf.put_u8(match member.state() {
            State::Alive => 0,
            State::Suspect => 1,
            State::Down => 2,
        });
        Ok(())
    }

    fn decode_member(&mut self, mut buf: impl Buf) -> Result<Member<SwimId>, PacketError> {
        let (id, incarnation) = (get_id(&mut buf)?, get_u16(&mut buf)?);
        let state = match get_u8(&mut buf)? {
            0 => State::Alive,
            1 => State::Suspect,
            2 => State::Down,
            _ => return Err(PacketError::Invalid("state")),
        };
        Ok(Member::new(id, incarnation, state))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn id(name: &str) -> SwimId {
        SwimId { node: NodeId::new(name).unwrap(), incarnation: 1 << 40, rejoins: 3 }
    }

    #[test]
    fn packets_round_trip_and_truncated_packets_fail() {
        let messages = [
            Message::Ping(1),
            Message::Ack(2),
            Message::PingReq { target: id("cyd"), probe_number: 3 },
            Message::IndirectPing { origin: id("cyd"), probe_number: 4 },
            Message::IndirectAck { target: id("cyd"), probe_number: 5 },
            Message::ForwardedAck { origin: id("cyd"), probe_number: 6 },
            Message::Announce,
            Message::Feed,
            Message::Gossip,
            Message::Broadcast,
            Message::TurnUndead,
        ];
        for message in messages {
            let header = Header { src: id("ada"), src_incarnation: 7, dst: id("bob"), message };
            let mut bytes = Vec::new();
            PacketCodec.encode_header(&header, &mut bytes).unwrap();
            assert_eq!(PacketCodec.decode_header(&bytes[..]), Ok(header.clone()));
            assert_eq!(PacketCodec.decode_header(&bytes[..bytes.len() - 1]), Err(PacketError::Truncated));
            let mut tight = Vec::new().limit(bytes.len() - 1);
            assert_eq!(PacketCodec.encode_header(&header, &mut tight), Err(PacketError::BufferFull));
            assert!(tight.get_ref().is_empty());
        }
        for state in [State::Alive, State::Suspect, State::Down] {
            let member = Member::new(id("ada"), 9, state);
            let mut bytes = Vec::new();
            PacketCodec.encode_member(&member, &mut bytes).unwrap();
            assert_eq!(PacketCodec.decode_member(&bytes[..]), Ok(member));
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            drop(PacketCodec.decode_header(&bytes[..]));
            drop(PacketCodec.decode_member(&bytes[..]));
        }
    }

    #[test]
    fn later_incarnations_win_conflicts_and_a_rejoin_creates_one() {
        use foca::Identity;
        let first = id("ada");
        let back = first.renew().unwrap();
        assert!(back.win_addr_conflict(&first) && !first.win_addr_conflict(&back));
        let same = SwimId { rejoins: first.rejoins + 1, ..first.clone() };
        assert!(same == first && !same.win_addr_conflict(&first));
    }
}
