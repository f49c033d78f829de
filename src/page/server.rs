//! Connections of browsers and programs: accepted, bounded, dropped when they do not read or say nothing.
//!
//! In: an address, TLS files, the service. Out: HTTP/1.1 until the process ends, on a thread of its own at a
//! lower priority: whatever a viewer does, the loop that keeps the robot's heartbeat does not notice.

use crate::config::page::{PageConfig, TlsFiles};
use crate::page::guard::Ends;
use axum::extract::ConnectInfo;
use axum::{Extension, Router};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// Connections at a time: a browser opens six.
const CONNECTIONS: usize = 200;

/// The same of one computer: others find room.
const OF_ONE: usize = 120;

/// The head of a request, and a TLS handshake, are there within this time.
const HEAD_WITHIN: Duration = Duration::from_secs(10);

/// What was sent and not read for so long ends the connection.
const UNREAD_WITHIN: Duration = Duration::from_secs(10);

/// Bytes that the kernel keeps for a viewer that does not read.
const SEND_BUFFER: usize = 64 * 1024;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is taken or not of this computer.
    #[error("page.listen: {address} cannot be used: {source}")]
    Bind {
        /// Which.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// Certificate or key.
    #[error("page.tls: {file}: {reason}")]
    Tls {
        /// Which file.
        file: String,
        /// Why.
        reason: String,
    },
    /// A file of texts.
    #[error("page.texts: {file}: {reason}")]
    Texts {
        /// Which file.
        file: String,
        /// Why.
        reason: String,
    },
    /// The system has no more threads or handles.
    #[error("the page's thread cannot be started: {0}")]
    Thread(std::io::Error),
}

/// A listener that is open, and how connections are secured.
pub struct Listening {
    listener: std::net::TcpListener,
    tls: Option<TlsAcceptor>,
}

impl Listening {
    /// Opens the address.
    ///
    /// # Errors
    /// It cannot be used, or certificate and key cannot.
    pub fn open(config: &PageConfig) -> Result<Listening, ServeError> {
        let tls = config.tls.as_ref().map(acceptor).transpose()?;
        let bind = |source| ServeError::Bind { address: config.listen, source };
        let listener = std::net::TcpListener::bind(config.listen).map_err(bind)?;
        listener.set_nonblocking(true).map_err(bind)?;
        Ok(Listening { listener, tls })
    }

    /// Where it listens: the port, where the configuration left it open.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listener.local_addr().ok()
    }

    /// Serves until the process ends. What the service starts runs on the same thread.
    ///
    /// # Errors
    /// No thread or no runtime.
    pub fn serve(self, service: impl FnOnce() -> Router + Send + 'static) -> Result<(), ServeError> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ServeError::Thread)?;
        let run = move || {
            cell_edge::priority::lower();
            runtime.block_on(self.accept(service()));
        };
        std::thread::Builder::new().name("page".into()).spawn(run).map_err(ServeError::Thread)?;
        Ok(())
    }

    async fn accept(self, router: Router) {
        let Ok(listener) = TcpListener::from_std(self.listener) else {
            return tracing::error!("the page's address was lost");
        };
        let places = Arc::new(Semaphore::new(CONNECTIONS));
        let mut per_computer: HashMap<IpAddr, Arc<Semaphore>> = HashMap::new();
        loop {
            let (stream, peer) = match listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    // Out of handles, say: others may close theirs.
                    tracing::warn!(%error, "page: a connection could not be accepted");
                    tokio::time::sleep(Duration::from_millis(200)).await;
                    continue;
                }
            };
            let mine = per_computer.entry(peer.ip()).or_insert_with(|| Arc::new(Semaphore::new(OF_ONE)));
            let of_one = mine.clone().try_acquire_owned();
            if per_computer.len() > CONNECTIONS {
                per_computer.retain(|_, places| places.available_permits() < OF_ONE);
            }
            let Ok(of_one) = of_one else {
                tracing::warn!(%peer, "page: too many connections of one computer");
                continue;
            };
            let Ok(place) = places.clone().try_acquire_owned() else {
                tracing::warn!(%peer, "page: too many connections");
                continue;
            };
            bound(&stream);
            // Under whatever address of its own, this computer is this computer.
            let near = stream.local_addr().ok();
            let ends = near.map(|near| Ends { far: peer, near });
            let here = near.is_some_and(|near| near.ip() == peer.ip());
            let peer = if here { SocketAddr::new(Ipv4Addr::LOCALHOST.into(), peer.port()) } else { peer };
            let router = ends.map_or_else(|| router.clone(), |ends| router.clone().layer(Extension(ends)));
            let tls = self.tls.clone();
            tokio::spawn(async move {
                let _places = (place, of_one);
                match tls {
                    None => connection(stream, peer, router).await,
                    Some(tls) => {
                        let secured = tokio::time::timeout(HEAD_WITHIN, tls.accept(stream)).await;
                        if let Ok(Ok(secured)) = secured {
                            connection(secured, peer, router).await;
                        }
                    }
                }
            });
        }
    }
}

/// A viewer that does not read is dropped by the kernel, and holds little memory until then.
fn bound(stream: &TcpStream) {
    let socket = socket2::SockRef::from(stream);
    let bounded = socket
        .set_tcp_user_timeout(Some(UNREAD_WITHIN))
        .and_then(|()| socket.set_send_buffer_size(SEND_BUFFER))
        .and_then(|()| socket.set_tcp_nodelay(true));
    if let Err(error) = bounded {
        tracing::debug!(%error, "page: a connection could not be bounded");
    }
}

async fn connection<S>(stream: S, peer: SocketAddr, router: Router)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let router = router.layer(Extension(ConnectInfo(peer)));
    let served = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_WITHIN)
        .max_buf_size(64 * 1024)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router));
    if let Err(error) = served.await {
        tracing::debug!(%peer, %error, "page: a connection ended");
    }
}

fn acceptor(files: &TlsFiles) -> Result<TlsAcceptor, ServeError> {
    let fault =
        |file: &std::path::Path, reason: String| ServeError::Tls { file: file.display().to_string(), reason };
    let certificates: Result<Vec<_>, _> =
        CertificateDer::pem_file_iter(&files.certificate).and_then(Iterator::collect);
    let certificates = certificates.map_err(|error| fault(&files.certificate, error.to_string()))?;
    let key =
        PrivateKeyDer::from_pem_file(&files.key).map_err(|error| fault(&files.key, error.to_string()))?;
    let config = ServerConfig::builder().with_no_client_auth().with_single_cert(certificates, key);
    let mut config = config.map_err(|error| fault(&files.certificate, error.to_string()))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use tokio_rustls::TlsConnector;
    use tokio_rustls::rustls::pki_types::ServerName;
    use tokio_rustls::rustls::{ClientConfig, RootCertStore};

    fn page(tls: Option<TlsFiles>) -> PageConfig {
        PageConfig {
            listen: ([127, 0, 0, 1], 0).into(),
            hosts: Vec::new(),
            control_from: Vec::new(),
            tls,
            texts: Vec::new(),
        }
    }

    fn router() -> Router {
        Router::new().route("/", axum::routing::get(|| async { "here" }))
    }

    const REQUEST: &[u8] = b"GET / HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";

    #[test]
    fn behind_tls_nothing_is_said_in_the_clear() {
        let folder = tempfile::tempdir().unwrap();
        let made = rcgen::generate_simple_self_signed(["localhost".to_string()]).unwrap();
        let files = TlsFiles { certificate: folder.path().join("c.pem"), key: folder.path().join("k.pem") };
        std::fs::write(&files.certificate, made.cert.pem()).unwrap();
        std::fs::write(&files.key, made.signing_key.serialize_pem()).unwrap();
        let listening = Listening::open(&page(Some(files))).unwrap();
        let address = listening.address().unwrap();
        listening.serve(router).unwrap();

        let mut roots = RootCertStore::empty();
        roots.add(made.cert.der().clone()).unwrap();
        let config = ClientConfig::builder().with_root_certificates(roots).with_no_client_auth();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let answer = runtime.block_on(async {
            use tokio::io::{AsyncReadExt, AsyncWriteExt};
            let plain = tokio::net::TcpStream::connect(address).await.unwrap();
            let name = ServerName::try_from("localhost").unwrap();
            let mut secured = TlsConnector::from(Arc::new(config)).connect(name, plain).await.unwrap();
            secured.write_all(REQUEST).await.unwrap();
            let mut answer = String::new();
            // The server may close without a farewell.
            let _ = secured.read_to_string(&mut answer).await;
            answer
        });
        assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("here"), "{answer}");

        let mut clear = std::net::TcpStream::connect(address).unwrap();
        clear.write_all(REQUEST).unwrap();
        let mut answer = Vec::new();
        let _ = clear.read_to_end(&mut answer);
        assert!(!String::from_utf8_lossy(&answer).contains("here"), "{answer:?}");
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let listening = Listening::open(&page(None)).unwrap();
        let taken = PageConfig { listen: listening.address().unwrap(), ..page(None) };
        let message = Listening::open(&taken).err().expect("taken").to_string();
        assert!(message.contains("page.listen") && message.contains("in use"), "{message}");
        let nowhere = TlsFiles { certificate: "/nowhere/c.pem".into(), key: "/nowhere/k.pem".into() };
        let message = Listening::open(&page(Some(nowhere))).err().expect("no file").to_string();
        assert!(message.contains("/nowhere/c.pem"), "{message}");
    }
}
