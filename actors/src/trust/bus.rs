//! A bus on which whatever nodes say bears its author's seal.

use super::certificates::{CertificateExchange, unix_time};
use super::keyring::{Keyring, VerifiedCertificate};
use super::record_signer::KeyringSigner;
use super::rejections::RejectionLog;
use crate::bus::{
    BusError, Encoding, Layer, MessageContent, Query, Replier, Reply, Sample, SharedBus, Stream, refuse_in_background,
};
use crate::clock::Clock;
use crate::gossip::SharedRecordSigner;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::Keys;
use consort_protocol::trust::{
    EnvelopeError, Fingerprint, Freshness, MessageKind, Operation, ReplayWindow, authorize, decode_envelope,
    decode_requester, encode_requester, signed_attachment, signed_part,
};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// A bus that seals what the fleet's nodes say, and hands out only what its author sealed, may say, and says for the first time.
///
/// What is below `wire/` is sealed all around. What anybody's clients read (views, answers to requests, events) stays as it is, with the
/// seal beside it. Everything else passes: certificates prove themselves, and presence has no content.
pub struct SigningBus {
    bus: SharedBus,
    keys: Keys,
    trust: Arc<Trust>,
}

/// Where the seal of a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Around it.
    Around,
    /// Beside it.
    Beside,
    /// Nowhere.
    Nowhere,
}

/// What is needed to believe.
struct Trust {
    keyring: Arc<Keyring>,
    cards: Arc<CertificateExchange>,
    refusals: Arc<RejectionLog>,
    clock: Clock,
}

impl SigningBus {
    /// Seals what is said on `bus` with `keyring`; `revoked` is the file that has the list of what is revoked, and is read again and
    /// again.
    ///
    /// # Errors
    /// [`BusError`] if the own certificate cannot be shown.
    pub async fn open(
        bus: SharedBus,
        keys: Keys,
        keyring: Arc<Keyring>,
        revoked: Option<PathBuf>,
        clock: Clock,
    ) -> Result<SigningBus, BusError> {
        let refusals = Arc::new(RejectionLog::default());
        let (on, ring, told) = (Arc::clone(&bus), Arc::clone(&keyring), Arc::clone(&refusals));
        let cards = Arc::new(CertificateExchange::open(on, keys.clone(), ring, revoked, clock, told).await?);
        Ok(SigningBus { bus, keys, trust: Arc::new(Trust { keyring, cards, refusals, clock }) })
    }

    /// Who signs what the bearer says of itself, and judges what others hand on of third ones.
    pub fn record_signer(&self) -> SharedRecordSigner {
        let Trust { keyring, cards, .. } = &*self.trust;
        Arc::new(KeyringSigner { keyring: Arc::clone(keyring), cards: Arc::clone(cards) })
    }

    /// What was not believed lately, in words: who claims what.
    pub fn rejections(&self) -> Vec<String> {
        self.trust.refusals.recent()
    }

    /// Where the seal is of what is said on a key, or key expression.
    fn place(&self, key: &str) -> Place {
        match self.keys.strip_fleet(key).and_then(|below| below.split_once('/')) {
            Some(("wire", rest)) if rest.starts_with("card/") => Place::Nowhere,
            Some(("wire", _)) => Place::Around,
            Some(("view" | "seen" | "api" | "events", _)) => Place::Beside,
            _ => Place::Nowhere,
        }
    }

    fn samples(&self, samples: Stream<Sample>, place: Place) -> Stream<Sample> {
        let (trust, keys, mut windows) = (Arc::clone(&self.trust), self.keys.clone(), Windows::default());
        samples.filter_map(move |sample| {
            let heard = Heard {
                kind: MessageKind::Publication,
                key: &sample.key,
                bytes: &sample.payload,
                beside: (place == Place::Beside).then_some(Beside { seal: &sample.attachment, asked: &[] }),
            };
            let believed = trust.believe(&keys, Operation::Publish, heard, Some(&mut windows)).ok()?;
            let payload = believed.payload(&sample.payload);
            Some(Sample { payload, attachment: Bytes::new(), ..sample })
        })
    }

    /// What nodes ask one another.
    fn sealed_questions(&self, questions: Stream<Query>) -> Stream<Query> {
        let (trust, keys, mut windows) = (Arc::clone(&self.trust), self.keys.clone(), Windows::default());
        questions.filter_map(move |query| {
            let heard = Heard { kind: MessageKind::Query, key: &query.key, bytes: &query.payload, beside: None };
            match trust.believe(&keys, Operation::Query, heard, Some(&mut windows)) {
                Ok(believed) => {
                    let payload = believed.payload(&query.payload);
                    let asked = MessageKind::Reply(believed.by, believed.number);
                    let keyring = Arc::clone(&trust.keyring);
                    let replier = Box::new(SealedReplier { replier: query.replier, keyring, asked, beside: None });
                    Some(Query { payload, replier, ..query })
                }
                Err(reason) => {
                    refuse_in_background(query, reason);
                    None
                }
            }
        })
    }

    /// What anybody asks: the links have seen to it that they may. Answers are sealed if somebody will look at the seal.
    fn anybodys_questions(&self, questions: Stream<Query>) -> Stream<Query> {
        let keyring = Arc::clone(&self.trust.keyring);
        questions.map(move |query| match decode_requester(&query.attachment) {
            Some(asked) => {
                let (keyring, beside) = (Arc::clone(&keyring), Some(query.payload.clone()));
                let replier = Box::new(SealedReplier { replier: query.replier, keyring, asked, beside });
                Query { replier, attachment: Bytes::new(), ..query }
            }
            None => query,
        })
    }

    /// Those answers to a question that are believed; of an answer beside which there is a seal, `asked` is the question.
    fn replies(&self, replies: Stream<Reply>, number: u64, asked: Option<Bytes>) -> Stream<Reply> {
        let (trust, keys) = (Arc::clone(&self.trust), self.keys.clone());
        let kind = MessageKind::Reply(self.trust.keyring.fingerprint(), number);
        replies.filter_map(move |reply| {
            let beside = asked.as_ref().map(|asked| Beside { seal: &reply.attachment, asked });
            let bytes = match &reply.payload {
                Ok(bytes) => bytes,
                // The fleet's own refuse in words of JSON, which bear a seal.
                Err(_) if beside.is_some() => return trust.unsealed(&keys, &reply.key),
                Err(_) => return Some(reply),
            };
            let heard = Heard { kind, key: &reply.key, bytes, beside };
            let believed = trust.believe(&keys, Operation::Reply, heard, None).ok()?;
            let payload = Ok(believed.payload(bytes));
            Some(Reply { payload, attachment: Bytes::new(), ..reply })
        })
    }
}

/// Something that was heard.
struct Heard<'a> {
    kind: MessageKind,
    key: &'a str,
    bytes: &'a Bytes,
    /// What stands beside it, if that is where its seal is.
    beside: Option<Beside<'a>>,
}

/// What stands beside something that was heard.
struct Beside<'a> {
    seal: &'a [u8],
    /// The question that it answers.
    asked: &'a [u8],
}

/// Something that is believed.
struct Believed {
    by: Fingerprint,
    number: u64,
    length: usize,
}

impl Believed {
    /// The message itself: it stands at the end.
    fn payload(&self, bytes: &Bytes) -> Bytes {
        bytes.slice(bytes.len() - self.length..)
    }
}

/// What was heard of each author, at one place.
type Windows = BTreeMap<Fingerprint, ReplayWindow>;

impl Trust {
    /// Whether something heard is from who it says, who may say it; and, of what is not an answer, for the first time.
    fn believe(
        &self,
        keys: &Keys,
        act: Operation,
        heard: Heard<'_>,
        windows: Option<&mut Windows>,
    ) -> Result<Believed, String> {
        let Heard { kind, key, bytes, beside } = heard;
        let below = keys.strip_fleet(key).unwrap_or(key);
        let sealed = match decode_envelope(kind, beside.as_ref().map_or(bytes, |beside| beside.seal)) {
            Ok(sealed) => sealed,
            Err(problem) => return self.refuse(format!("somebody on {below}: {problem}")),
        };
        let (payload, signed, shown) = match &beside {
            None => (sealed.payload, signed_part(kind, sealed.signer, sealed.number, key, sealed.payload), None),
            Some(beside) => {
                let signed = signed_attachment(kind, sealed.signer, sealed.number, key, beside.asked, bytes);
                (&bytes[..], signed, Some(sealed.payload))
            }
        };
        let card = match (self.keyring.certificate(sealed.signer), shown) {
            (Some(card), _) => card,
            (None, Some(certificate)) => match self.keyring.add_certificate(certificate, unix_time(self.clock)) {
                Ok(card) if card.fingerprint() == sealed.signer => card,
                Ok(card) => {
                    let bearer = &card.identity.principal;
                    return self.refuse(format!("somebody on {below} shows the certificate of {bearer} for another"));
                }
                Err(problem) => {
                    return self.refuse(format!("somebody on {below} whose certificate is not believed: {problem}"));
                }
            },
            (None, None) => {
                self.cards.request(sealed.signer);
                return Err(format!("certificate {} is not known here yet: ask again", sealed.signer));
            }
        };
        if !card.verify(&signed, sealed.signature) {
            return self.refuse(format!(
                "somebody on {below} says to be {}, whose signature it is not",
                card.identity.principal
            ));
        }
        if let Err(denied) = authorize(&card.identity, act, below, payload) {
            return self.refuse(denied.to_string());
        }
        if let Some(windows) = windows {
            match windows.entry(sealed.signer).or_default().accept(sealed.number) {
                Freshness::New => {}
                Freshness::Repeated => return Err("it was heard before".to_owned()),
                Freshness::Old => return self.refuse(late(&card, below)),
            }
        }
        Ok(Believed { by: sealed.signer, number: sealed.number, length: payload.len() })
    }

    /// Something is not believed, and that is told.
    fn refuse<T>(&self, reason: String) -> Result<T, String> {
        self.refusals.record(reason.clone());
        Err(reason)
    }

    /// The same of something that bears no seal.
    fn unsealed<T>(&self, keys: &Keys, key: &str) -> Option<T> {
        let below = keys.strip_fleet(key).unwrap_or(key);
        self.refuse(format!("somebody on {below}: {}", EnvelopeError::Unsigned)).ok()
    }
}

fn late(card: &VerifiedCertificate, below: &str) -> String {
    let bearer = &card.identity.principal;
    format!(
        "what {bearer} says on {below} is older than what it said before: somebody repeats it, or its clock was put back"
    )
}

impl Layer for SigningBus {
    /// The number of a question that was sealed, and the question itself if the seals of its answers stand beside them.
    type QueryState = Option<(u64, Option<Bytes>)>;

    fn inner(&self) -> &SharedBus {
        &self.bus
    }

    fn outgoing_publication(&self, key: &str, said: MessageContent) -> Result<MessageContent, BusError> {
        let keyring = &self.trust.keyring;
        Ok(match self.place(key) {
            Place::Around => {
                let payload =
                    keyring.sign_envelope(MessageKind::Publication, keyring.next_number(), key, &said.payload).into();
                MessageContent { payload, ..said }
            }
            Place::Beside => {
                let beside = keyring.sign_detached(MessageKind::Publication, key, &[], &said.payload).into();
                MessageContent { attachment: beside, ..said }
            }
            Place::Nowhere => said,
        })
    }

    fn incoming_publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample> {
        match self.place(key_expr) {
            Place::Nowhere => samples,
            place => self.samples(samples, place),
        }
    }

    fn outgoing_query(
        &self,
        key_expr: &str,
        said: MessageContent,
    ) -> Result<(MessageContent, Self::QueryState), BusError> {
        let keyring = &self.trust.keyring;
        // What is asked reaches whoever answers without its parameters.
        let key = key_expr.split('?').next().unwrap_or_default();
        Ok(match self.place(key) {
            Place::Nowhere => (said, None),
            Place::Around => {
                let number = keyring.next_number();
                let payload = keyring.sign_envelope(MessageKind::Query, number, key, &said.payload).into();
                (MessageContent { payload, ..said }, Some((number, None)))
            }
            Place::Beside => {
                let number = keyring.next_number();
                let (beside, asked) = (encode_requester(keyring.fingerprint(), number).into(), said.payload.clone());
                (MessageContent { attachment: beside, ..said }, Some((number, Some(asked))))
            }
        })
    }

    fn incoming_replies(&self, asked: Self::QueryState, replies: Stream<Reply>) -> Stream<Reply> {
        match asked {
            Some((number, asked)) => self.replies(replies, number, asked),
            None => replies,
        }
    }

    fn incoming_queries(&self, key_expr: &str, incoming_queries: Stream<Query>) -> Stream<Query> {
        match self.place(key_expr) {
            Place::Around => self.sealed_questions(incoming_queries),
            Place::Beside => self.anybodys_questions(incoming_queries),
            Place::Nowhere => incoming_queries,
        }
    }
}

/// Answers one question, sealed as the answer to it.
struct SealedReplier {
    replier: Box<dyn Replier>,
    keyring: Arc<Keyring>,
    asked: MessageKind,
    /// The question, if the seal is to stand beside the answer.
    beside: Option<Bytes>,
}

#[async_trait]
impl Replier for SealedReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        let (payload, beside) = match &self.beside {
            None => (self.keyring.sign_envelope(self.asked, self.keyring.next_number(), key, &payload).into(), beside),
            Some(asked) => {
                let seal = self.keyring.sign_detached(self.asked, key, asked, &payload);
                (payload, seal.into())
            }
        };
        self.replier.reply_with_attachment(key, payload, beside, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.replier.refuse(reason).await
    }
}
