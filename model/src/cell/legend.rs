//! What charts show of a cell's text: the line of each step, and the values that messages carry.

use imrs_protocol::script::{Address, Format, Program, Trigger, Type};
use imrs_protocol::{CONTENTS_BYTES, Kind, Packet, PortId};

/// Lines and formats of a cell's text. If they are empty, charts show neither lines nor values.
#[derive(Clone, Debug, Default)]
pub struct Legend {
    /// For each task and operation of its program, the line of the statement, from 1.
    pub lines: Vec<Vec<u32>>,
    /// For each task and handler of its program, the line of the handler's head, from 1.
    pub handlers: Vec<Vec<u32>>,
    /// For each port, the formats of its messages and of its answers.
    pub formats: Vec<(Format, Format)>,
}

impl Legend {
    /// The values in a packet, as text: `(3, true)`. Of a message in several packets, only the values in the first packet
    /// are shown.
    pub(super) fn of_packet(&self, packet: &Packet) -> Option<String> {
        let arguments;
        let (bytes, is_answer) = match packet.kind {
            Kind::Send | Kind::Query => (packet.contents.as_bytes(), false),
            Kind::Reply | Kind::Response => (packet.contents.as_bytes(), true),
            Kind::Arrive => {
                arguments = packet.meeting().arguments;
                (&arguments[..], false)
            }
            Kind::Confirm | Kind::Abort | Kind::Control => return None,
        };
        if packet.fragment > 0 {
            return None;
        }
        self.values(packet.port, is_answer, bytes)
    }

    pub(super) fn values(&self, port: PortId, is_answer: bool, bytes: &[u8]) -> Option<String> {
        let (message, answer) = self.formats.get(port.index())?;
        let format = if is_answer { answer } else { message };
        let mut values: Vec<String> = format.values(bytes).map(|(of, value)| shown(of, value)).collect();
        if format.bytes() > CONTENTS_BYTES {
            values.push("..".into());
        }
        let is_whole = values.len() >= format.fields.len().min(1);
        (is_whole && !values.is_empty()).then(|| format!("({})", values.join(", ")))
    }

    pub(super) fn line(&self, task: usize, at: Address) -> Option<u32> {
        self.lines.get(task)?.get(usize::from(at)).copied()
    }

    pub(super) fn handler(&self, program: &Program, task: usize, trigger: Trigger) -> Option<u32> {
        let at = program.handlers.iter().position(|handler| handler.trigger == trigger)?;
        self.handlers.get(task)?.get(at).copied()
    }
}

/// A value as the cell's text writes it.
pub(super) fn shown(of: Type, value: i64) -> String {
    match of {
        Type::Bool => (value != 0).to_string(),
        Type::Real => u32::try_from(value).map(f32::from_bits).unwrap_or_default().to_string(),
        Type::Int8 | Type::Int16 | Type::Int32 | Type::Word => value.to_string(),
    }
}
