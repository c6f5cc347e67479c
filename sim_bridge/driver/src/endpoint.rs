//! Endpoint of a robot's driver: a program that the node starts, or a socket that the node connects to.

use crate::program::{DriverProgram, ProgramError};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use tokio::io::{AsyncRead, AsyncWrite, split};
use tokio::net::{TcpStream, UnixStream};

/// Driver of a robot, as in its file: the words of a command line, or the text of a socket.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum DriverSetting {
    /// Command line: `["python3", "driver.py"]`.
    Command(Vec<String>),
    /// Socket: `unix:driver.sock` or `tcp:127.0.0.1:7700`.
    Socket(String),
}

/// Driver of a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DriverEndpoint {
    /// A program that the node starts.
    Program(DriverProgram),
    /// A socket on which a driver listens.
    Socket(DriverSocket),
}

/// Socket on which a driver listens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DriverSocket {
    /// Unix socket.
    Unix(PathBuf),
    /// Loopback address. A driver obeys every client, so other machines must not reach it.
    Tcp(SocketAddr),
}

/// The setting of a driver is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EndpointError {
    /// The command line is invalid.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// The text is no socket.
    #[error(
        "{0:?} is no socket; allowed is `unix:PATH`, `tcp:127.0.0.1:PORT`, or the list of a program and its arguments"
    )]
    NoSocket(String),
    /// The address is reachable from other machines.
    #[error("{0} is not a loopback address; a driver obeys every client, so allowed is `tcp:127.0.0.1:PORT`")]
    NotLoopback(SocketAddr),
}

/// Stream of lines from a driver.
pub(crate) type SocketReader = Box<dyn AsyncRead + Send + Unpin>;
/// Stream of lines to a driver.
pub(crate) type SocketWriter = Box<dyn AsyncWrite + Send + Unpin>;

impl DriverSetting {
    /// Makes paths relative to `folder`, as [`DriverProgram::resolve`] does.
    pub fn resolve(&mut self, folder: &Path) {
        match self {
            DriverSetting::Command(words) => DriverProgram::resolve(words, folder),
            DriverSetting::Socket(text) => {
                if let Some(path) = text.strip_prefix(UNIX) {
                    let path = folder.join(path).components().collect::<PathBuf>();
                    *text = format!("{UNIX}{}", path.display());
                }
            }
        }
    }
}

const UNIX: &str = "unix:";
const TCP: &str = "tcp:";

impl TryFrom<DriverSetting> for DriverEndpoint {
    type Error = EndpointError;

    fn try_from(setting: DriverSetting) -> Result<DriverEndpoint, EndpointError> {
        let text = match setting {
            DriverSetting::Command(words) => return Ok(DriverProgram::new(words)?.into()),
            DriverSetting::Socket(text) => text,
        };
        let path = text.strip_prefix(UNIX).filter(|path| !path.is_empty());
        let address = text.strip_prefix(TCP).and_then(|address| address.parse::<SocketAddr>().ok());
        match (path, address) {
            (Some(path), _) => Ok(DriverEndpoint::Socket(DriverSocket::Unix(PathBuf::from(path)))),
            (None, Some(address)) if address.ip().is_loopback() => {
                Ok(DriverEndpoint::Socket(DriverSocket::Tcp(address)))
            }
            (None, Some(address)) => Err(EndpointError::NotLoopback(address)),
            (None, None) => Err(EndpointError::NoSocket(text)),
        }
    }
}

impl From<DriverProgram> for DriverEndpoint {
    fn from(program: DriverProgram) -> DriverEndpoint {
        DriverEndpoint::Program(program)
    }
}

impl DriverEndpoint {
    /// Checks that a program exists. A socket may appear later.
    ///
    /// # Errors
    /// [`ProgramError::NotFound`].
    pub fn check_exists(&self) -> Result<(), ProgramError> {
        match self {
            DriverEndpoint::Program(program) => program.check_exists(),
            DriverEndpoint::Socket(_) => Ok(()),
        }
    }
}

impl DriverSocket {
    /// Connects to the driver.
    pub(crate) async fn connect(&self) -> io::Result<(SocketReader, SocketWriter)> {
        Ok(match self {
            DriverSocket::Unix(path) => boxed(UnixStream::connect(path).await?),
            DriverSocket::Tcp(address) => {
                let stream = TcpStream::connect(address).await?;
                stream.set_nodelay(true)?;
                boxed(stream)
            }
        })
    }
}

fn boxed(stream: impl AsyncRead + AsyncWrite + Send + 'static) -> (SocketReader, SocketWriter) {
    let (reader, writer) = split(stream);
    (Box::new(reader), Box::new(writer))
}

impl fmt::Display for DriverSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            DriverSocket::Unix(path) => write!(f, "{UNIX}{}", path.display()),
            DriverSocket::Tcp(address) => write!(f, "{TCP}{address}"),
        }
    }
}

impl JsonSchema for DriverSetting {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "DriverSetting".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [
            { "type": "array", "items": { "type": "string" }, "minItems": 1 },
            { "type": "string", "pattern": "^(unix|tcp):.+$" },
        ] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn endpoint(text: &str) -> Result<String, String> {
        match DriverEndpoint::try_from(DriverSetting::Socket(text.to_owned())) {
            Ok(DriverEndpoint::Socket(socket)) => Ok(socket.to_string()),
            Ok(DriverEndpoint::Program(program)) => panic!("{program:?}"),
            Err(problem) => Err(problem.to_string()),
        }
    }

    #[test]
    fn sockets_of_this_machine_are_accepted() {
        for text in ["unix:/run/driver.sock", "tcp:127.0.0.1:7700", "tcp:[::1]:7700"] {
            assert_eq!(endpoint(text), Ok(text.to_owned()));
        }
        for text in ["unix:", "driver.sock", "tcp:7700", "tcp:localhost:7700", ""] {
            let problem = endpoint(text).unwrap_err();
            assert!(problem.contains("is no socket; allowed is `unix:PATH`"), "{problem}");
        }
        assert!(endpoint("tcp:0.0.0.0:7700").unwrap_err().contains("0.0.0.0:7700 is not a loopback address"));
    }

    #[test]
    fn the_path_of_a_socket_is_relative_to_its_file() {
        let resolved = |text: &str| {
            let mut setting = DriverSetting::Socket(text.to_owned());
            setting.resolve(Path::new("/etc/consort"));
            setting
        };
        assert_eq!(resolved("unix:driver.sock"), DriverSetting::Socket("unix:/etc/consort/driver.sock".to_owned()));
        assert_eq!(resolved("unix:/run/a.sock"), DriverSetting::Socket("unix:/run/a.sock".to_owned()));
        assert_eq!(resolved("tcp:127.0.0.1:1"), DriverSetting::Socket("tcp:127.0.0.1:1".to_owned()));
    }
}
