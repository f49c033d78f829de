//! Scripts that call a server by XML-RPC, over real sockets.

use super::*;
use std::io::{BufRead, BufReader};

/// A server for as many calls as there are answers; what it was sent comes out of the channel.
fn rpc_server(answers: &'static [&'static str]) -> (u16, std::sync::mpsc::Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let (sender, bodies) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for answer in answers {
            let (stream, _) = listener.accept().unwrap();
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            let mut length = 0;
            loop {
                let mut line = String::new();
                reader.read_line(&mut line).unwrap();
                if let Some(number) = line.strip_prefix("Content-Length: ") {
                    length = number.trim().parse().unwrap();
                }
                if line == "\r\n" {
                    break;
                }
            }
            let mut body = vec![0; length];
            reader.read_exact(&mut body).unwrap();
            sender.send(String::from_utf8(body).unwrap()).unwrap();
            let text = format!(
                "<?xml version='1.0'?><methodResponse><params><param><value>{answer}</value></param></params>\
                 </methodResponse>"
            );
            let head = format!("HTTP/1.0 200 OK\r\nContent-Length: {}\r\n\r\n", text.len());
            (&stream).write_all((head + &text).as_bytes()).unwrap();
        }
    });
    (port, bodies)
}

#[test]
fn scripts_call_methods_of_a_server_and_wait_for_the_answer() {
    let (port, bodies) = rpc_server(&[
        "<int>5</int>",
        "<struct><member><name>x</name><value><double>0.5</double></value></member><member><name>y</name>\
         <value><double>0</double></value></member><member><name>z</name><value><double>1</double></value>\
         </member><member><name>rx</name><value><double>0</double></value></member><member><name>ry</name>\
         <value><double>0</double></value></member><member><name>rz</name><value><double>2</double></value>\
         </member></struct>",
    ]);
    let script = format!(
        "def r():\n thread tick():\n  while True:\n   write_output_integer_register(24, \
         read_output_integer_register(24) + 1)\n   sync()\n  end\n end\n run tick()\n \
         pc = rpc_factory(\"xmlrpc\", \"http://127.0.0.1:{port}/RPC2\")\n \
         textmsg(pc.add(2, 3.5, True, \"a&b\", [1, 2]) + 1)\n p = pc.pose(p[1,2,3,0,0,0])\n \
         textmsg(pose_trans(p, p[0,0,1,0,0,0])[2])\n textmsg(pc.closeXMLRPCClientConnection())\n \
         textmsg(read_output_integer_register(24) > 0)\nend\n"
    );
    assert_eq!(said(&script), ["6", "2", "True", "True"]);
    let first = bodies.recv().unwrap();
    assert!(first.contains("<methodName>add</methodName><params><param><value><int>2</int></value></param>"));
    assert!(first.contains("<double>3.5</double>") && first.contains("<boolean>1</boolean>"), "{first}");
    assert!(first.contains("<string>a&amp;b</string>") && first.contains("<array><data>"), "{first}");
    let second = bodies.recv().unwrap();
    assert!(second.contains("<name>x</name><value><double>1</double></value>"), "{second}");
}

#[test]
fn a_server_that_is_not_there_or_answers_nonsense_is_an_exception() {
    let nowhere = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mute = server(drop);
    let nonsense = server(|mut stream| {
        let _ = stream.read(&mut [0; 4096]);
        let _ = stream.write_all(b"HTTP/1.0 500 Oops\r\n\r\n");
    });
    for (port, reason) in [(nowhere, "no connection"), (mute, "without an answer"), (nonsense, "status 500")]
    {
        let url = format!("http://127.0.0.1:{port}/");
        let text = said(&format!("def r():\n pc = rpc_factory(\"xmlrpc\", \"{url}\")\n pc.ask()\nend\n"));
        assert!(
            text.len() == 1 && text[0].starts_with("exception ask at") && text[0].contains(reason),
            "{text:?}"
        );
    }
    assert!(said("def r():\n rpc_factory(\"soap\", \"http://pc\")\nend\n")[0].contains("no type soap"));
    assert!(said("def r():\n x = 1\n x.ask()\nend\n")[0].contains("int has no method"));
}
