//! Tests of the RTDE codec. The hex below is what the wire carries (built by hand from the vendor's guide):
//! a failure here means the wire changed, and every controller and client in the field with it. Do not
//! "fix" a golden string without a capture that shows the new bytes.

use super::*;
use crate::rtde_values::VariableType;
use proptest::prelude::*;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn frame(bytes: &[u8]) -> Frame {
    let mut splitter = Splitter::default();
    splitter.push(bytes);
    splitter.next_frame().unwrap().unwrap()
}

#[track_caller]
fn request(version: Version, request: Request, golden: &str) {
    let bytes = request.encode(version);
    assert_eq!(hex(&bytes), golden, "the wire changed: {request:?}");
    assert_eq!(Request::decode(version, &frame(&bytes)).unwrap(), request);
}

#[track_caller]
fn reply(version: Version, reply: Reply, golden: &str) {
    let bytes = reply.encode(version);
    assert_eq!(hex(&bytes), golden, "the wire changed: {reply:?}");
    assert_eq!(Reply::decode(version, &frame(&bytes)).unwrap(), reply);
}

fn text() -> TextMessage {
    TextMessage { message: "hi".into(), source: "me".into(), level: Level::Warning }
}

#[test]
fn golden_requests() {
    let names = vec!["timestamp".to_string(), "actual_q".to_string()];
    request(Version::V1, Request::ProtocolVersion(2), "0005560002");
    request(Version::V2, Request::ControllerVersion, "000376");
    request(Version::V2, Request::Text(text()), "000a4d026869026d6502");
    request(
        Version::V2,
        Request::SetupOutputs { frequency_hz: Some(500.0), names: names.clone() },
        "001d4f407f40000000000074696d657374616d702c61637475616c5f71",
    );
    request(
        Version::V1,
        Request::SetupOutputs { frequency_hz: None, names: names.clone() },
        "00154f74696d657374616d702c61637475616c5f71",
    );
    request(Version::V2, Request::SetupInputs { names }, "00154974696d657374616d702c61637475616c5f71");
    request(Version::V2, Request::Start, "000353");
    request(Version::V2, Request::Pause, "000350");
    request(Version::V2, Request::Data { recipe: 1, payload: vec![0, 0, 0, 7] }, "0008550100000007");
}

#[test]
fn golden_replies() {
    let offers = vec![Offer::Type(VariableType::Double), Offer::InUse];
    let version = ControllerVersion { major: 5, minor: 20, bugfix: 0, build: 1_234_567 };
    reply(Version::V1, Reply::ProtocolVersion(true), "00045601");
    reply(Version::V2, Reply::ControllerVersion(version), "0013760000000500000014000000000012d687");
    reply(Version::V2, Reply::Text(text()), "000a4d026869026d6502");
    reply(Version::V1, Reply::Text(TextMessage { source: String::new(), ..text() }), "00064d026869");
    reply(
        Version::V2,
        Reply::SetupOutputs { recipe: 1, offers: offers.clone() },
        "00114f01444f55424c452c494e5f555345",
    );
    reply(
        Version::V1,
        Reply::SetupOutputs { recipe: 1, offers: offers.clone() },
        "00104f444f55424c452c494e5f555345",
    );
    reply(Version::V2, Reply::SetupInputs { recipe: 0, offers }, "00114900444f55424c452c494e5f555345");
    reply(Version::V2, Reply::Start(true), "00045301");
    reply(Version::V2, Reply::Pause(true), "00045001");
    reply(Version::V2, Reply::Data { recipe: 1, payload: vec![1, 2] }, "000655010102");
    reply(Version::V1, Reply::Data { recipe: 1, payload: vec![1, 2] }, "0005550102");
}

#[test]
fn a_trailing_comma_is_tolerated_from_clients_only() {
    let list = Frame { kind: b'I', payload: b"timestamp,actual_q,".to_vec() };
    let Request::SetupInputs { names } = Request::decode(Version::V2, &list).unwrap() else { panic!() };
    assert_eq!(names, ["timestamp", "actual_q"]);
    let reply = Frame { kind: b'I', payload: b"\x01DOUBLE,".to_vec() };
    assert!(Reply::decode(Version::V2, &reply).is_err());
}

#[test]
fn errors_say_what_was_there() {
    let error = Reply::decode(Version::V2, &Frame { kind: b'Z', payload: vec![] }).unwrap_err();
    assert_eq!(error, WireError::UnknownType { found: b'Z' });
    let error = Reply::decode(Version::V2, &Frame { kind: b'O', payload: b"\x01DOUBLE,VECTOR9D".to_vec() });
    assert!(error.unwrap_err().to_string().contains("VECTOR9D"));
    let error = Reply::decode(Version::V2, &Frame { kind: b'S', payload: vec![2] }).unwrap_err();
    assert_eq!(error.to_string(), "accepted at offset 0 is 2, expected 0 or 1");
    assert!(Reply::decode(Version::V2, &Frame { kind: b'S', payload: vec![1, 0] }).is_err());
}

#[test]
fn packages_come_out_whole_however_they_are_cut() {
    let packages = [
        Request::ProtocolVersion(2).encode(Version::V2),
        Request::Start.encode(Version::V2),
        Request::Data { recipe: 2, payload: vec![9; 300] }.encode(Version::V2),
    ];
    let stream = packages.concat();
    for cut in 1..stream.len() {
        let mut splitter = Splitter::default();
        let mut seen = Vec::new();
        for part in [&stream[..cut], &stream[cut..]] {
            splitter.push(part);
            while let Some(frame) = splitter.next_frame().unwrap() {
                seen.push(frame.encode());
            }
        }
        assert_eq!(seen, packages, "cut at {cut}");
    }
}

#[test]
fn a_size_below_the_header_ends_the_stream() {
    let mut splitter = Splitter::default();
    splitter.push(&[0, 2, b'U', 0, 3, b'S']);
    assert!(matches!(splitter.next_frame(), Err(WireError::Length { found: 2, .. })));
    assert_eq!(splitter.next_frame(), Ok(None));
}

proptest! {
    #[test]
    fn foreign_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let mut splitter = Splitter::default();
        splitter.push(&bytes);
        while let Ok(Some(frame)) = splitter.next_frame() {
            for version in [Version::V1, Version::V2] {
                let _ = Request::decode(version, &frame);
                let _ = Reply::decode(version, &frame);
            }
        }
    }

    #[test]
    fn damaged_packages_never_panic(kind in prop::sample::select(b"VvMOISPU".to_vec()),
                                    payload in proptest::collection::vec(any::<u8>(), 0..64)) {
        let frame = Frame { kind, payload };
        for version in [Version::V1, Version::V2] {
            if let Ok(request) = Request::decode(version, &frame) {
                let _ = request.encode(version);
            }
            if let Ok(reply) = Reply::decode(version, &frame) {
                // What decodes encodes to something that decodes to the same.
                let again = self::frame(&reply.encode(version));
                // NaN payloads are raw bytes here, so equality is exact.
                prop_assert_eq!(Reply::decode(version, &again).unwrap(), reply);
            }
        }
    }
}
