//! Connections of browsers and programs: accepted, bounded, dropped when they do not read or say nothing.
//!
//! In: an address, TLS files, the service. Out: HTTP/1.1 until the process ends, on a thread of its own at a
//! lower priority: whatever a viewer does, the loop that keeps the robot's heartbeat does not notice.

use crate::config::page::{PageConfig, TlsFiles};
use crate::page::connections::{Connections, Place, followed};
use crate::page::guard::Ends;
use axum::extract::ConnectInfo;
use axum::middleware::from_fn_with_state;
use axum::{Extension, Router};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// The head of a request, and a TLS handshake, are there within this time.
const HEAD_WITHIN: Duration = Duration::from_secs(2);

/// What was sent and not read for so long ends the connection.
const UNREAD_WITHIN: Duration = Duration::from_secs(10);

/// A connection that is cut has given its handle back within this time.
const CUT_WITHIN: Duration = Duration::from_millis(200);

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
        source: io::Error,
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
    Thread(io::Error),
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
        let connections = Connections::default();
        loop {
            let (stream, peer) = match listener.accept().await.and_then(with_handles_left) {
                Ok(accepted) => accepted,
                Err(error) => {
                    // Another connection gives up its handle, which goes to the reserve first.
                    tracing::warn!(%error, "page: a connection could not be accepted");
                    connections.cut_one();
                    tokio::time::sleep(CUT_WITHIN).await;
                    let _ = cell_edge::reserve::fill();
                    continue;
                }
            };
            let Some(place) = connections.arrive(peer.ip()) else {
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
            let router = router.layer(from_fn_with_state(place.clone(), followed));
            let served = secured(stream, self.tls.clone(), peer, router);
            tokio::spawn(until_cut(served, place));
        }
    }
}

/// Closes a connection whose handle the reserve needs.
fn with_handles_left(accepted: (TcpStream, SocketAddr)) -> io::Result<(TcpStream, SocketAddr)> {
    if cell_edge::reserve::fill() {
        return Ok(accepted);
    }
    drop(accepted);
    Err(io::Error::from_raw_os_error(rustix::io::Errno::MFILE.raw_os_error()))
}

/// Serves a connection until it ends, or until its place is for another one.
async fn until_cut(served: impl Future<Output = ()>, place: Place) {
    tokio::select! {
        () = served => {}
        () = place.cut() => tracing::debug!("page: a connection was cut for a new one"),
    }
}

/// Serves a connection behind TLS, where there is TLS.
async fn secured(stream: TcpStream, tls: Option<TlsAcceptor>, peer: SocketAddr, router: Router) {
    let Some(tls) = tls else { return connection(stream, peer, router).await };
    if let Ok(Ok(secured)) = tokio::time::timeout(HEAD_WITHIN, tls.accept(stream)).await {
        connection(secured, peer, router).await;
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

    /// A connection to the page from an address of its own, with a request or a part of one.
    fn from(last: usize, page: SocketAddr, request: &[u8]) -> std::net::TcpStream {
        let socket =
            socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).expect("a socket");
        socket.set_recv_buffer_size(4096).expect("a small buffer");
        let address = Ipv4Addr::new(127, 1, u8::try_from(last / 200).expect("few"), 1 + (last % 200) as u8);
        socket.bind(&SocketAddr::from((address, 0)).into()).expect("bound");
        socket.connect(&page.into()).expect("connected");
        let mut stream = std::net::TcpStream::from(socket);
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
        // One that is cut may be gone already.
        let _ = stream.write_all(request);
        stream
    }

    fn answer(mut stream: std::net::TcpStream) -> String {
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    #[test]
    fn an_order_is_answered_among_slow_heads_slow_bodies_and_unread_answers() {
        const OTHERS: usize = 220;
        /// More than both ends buffer.
        static BYTES: [u8; 1 << 20] = [b'x'; 1 << 20];
        const LARGE: &[u8] = &BYTES;
        cell_edge::reserve::raise_limit();
        let (begun, has_begun) = std::sync::mpsc::channel();
        let release = Arc::new(tokio::sync::Notify::new());
        let hold = release.clone();
        let order = |place: Extension<Place>| async move {
            place.signed_in("anna");
            "ordered"
        };
        let held = move |place: Extension<Place>| async move {
            place.signed_in("ben");
            place.serves();
            let _ = begun.send(());
            hold.notified().await;
            "held"
        };
        let viewer = |place: Extension<Place>, body: axum::body::Body| async move {
            place.signed_in("eve");
            let _ = axum::body::to_bytes(body, 10).await;
        };
        let routes = Router::new()
            .route("/viewer", axum::routing::post(viewer))
            .route("/order", axum::routing::get(order))
            .route("/held", axum::routing::get(held))
            .route("/large", axum::routing::get(|| async { LARGE }));
        let listening = Listening::open(&page(None)).unwrap();
        let address = listening.address().unwrap();
        listening.serve(|| routes).unwrap();
        let request =
            |path: &str| format!("GET {path} HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n").into_bytes();
        let in_work = from(0, address, &request("/held"));
        has_begun.recv_timeout(Duration::from_secs(60)).expect("it is served");

        let half_sent = b"POST /viewer HTTP/1.1\r\nhost: a\r\ncontent-length: 10\r\n\r\n".to_vec();
        for sent in [b"GET / HTTP/1.1\r\nhost: ".to_vec(), request("/large"), half_sent] {
            let others: Vec<_> = (1..=OTHERS).map(|last| from(last, address, &sent)).collect();
            // Accepted after all of them.
            let answer = answer(from(OTHERS + 1, address, &request("/order")));
            assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("ordered"), "{answer}");
            drop(others);
        }
        release.notify_one();
        assert!(answer(in_work).ends_with("held"), "a request of a session is not cut");
    }
}
