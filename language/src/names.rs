//! Visits every name in a syntax tree.

use crate::ast::{
    CheckKind, CoupleKind, Expr, ExprKind, Fault, Field, File, Item, Name, Place, PortOptionKind, Statement,
    StatementKind, TaskDecl, Trigger, TypeName,
};

/// Calls `see` with each name of the file.
pub(crate) fn each<'f>(file: &'f File, see: &mut dyn FnMut(&'f Name)) {
    file.name.iter().for_each(&mut *see);
    for item in &file.items {
        match item {
            Item::Tick(_) => {}
            Item::Link(link) => [&link.a, &link.b].into_iter().for_each(&mut *see),
            Item::Node(node) => see(&node.name),
            Item::Type(of) => {
                see(&of.name);
                fields(&of.fields, see);
            }
            Item::Task(task) => of_task(task, see),
            Item::Couple(couple) => of_couple(&couple.kind, see),
            Item::Faults(faults) => {
                for fault in &faults.faults {
                    match fault {
                        Fault::Crash(name) | Fault::Pause(name, _) => see(name),
                        Fault::Cut(a, b) => [a, b].into_iter().for_each(&mut *see),
                        Fault::Loss(_) | Fault::Dup(_) | Fault::Fail(_) | Fault::Drift(_) => {}
                    }
                }
            }
            Item::Check(check) => {
                see(&check.name);
                match &check.kind {
                    CheckKind::Never(of) | CheckKind::Always(of) => expr(of, see),
                    CheckKind::Leads { when, then, .. } => {
                        [when, then].into_iter().for_each(|of| expr(of, see));
                    }
                }
            }
        }
    }
}

fn fields<'f>(fields: &'f [Field], see: &mut dyn FnMut(&'f Name)) {
    for field in fields {
        see(&field.name);
        field.of.iter().for_each(|of| type_name(of, see));
    }
}

fn type_name<'f>(of: &'f TypeName, see: &mut dyn FnMut(&'f Name)) {
    match of {
        TypeName::Record(name) => see(name),
        TypeName::Plain(..) | TypeName::Timer(_) => {}
    }
}

fn of_couple<'f>(kind: &'f CoupleKind, see: &mut dyn FnMut(&'f Name)) {
    match kind {
        CoupleKind::Loose { tasks, over } => tasks.iter().chain([over]).for_each(see),
        CoupleKind::Tight(tasks) => tasks.iter().for_each(see),
        CoupleKind::Serial(first, then) => [first, then].into_iter().for_each(see),
        CoupleKind::Work { primary, standby, via, .. } => [primary, standby, via].into_iter().for_each(see),
    }
}

fn of_task<'f>(task: &'f TaskDecl, see: &mut dyn FnMut(&'f Name)) {
    [&task.name, &task.on].into_iter().for_each(&mut *see);
    [&task.module, &task.standby_of, &task.end].into_iter().flatten().for_each(&mut *see);
    for port in &task.ports {
        see(&port.name);
        fields(&port.parameters, see);
        port.answer.iter().for_each(|of| type_name(of, see));
        for option in &port.options {
            match &option.kind {
                PortOptionKind::MessageFormat(name) => see(name),
                PortOptionKind::UserList(names) => names.iter().for_each(&mut *see),
                PortOptionKind::Usage(_)
                | PortOptionKind::TimeOut(_)
                | PortOptionKind::Class(_)
                | PortOptionKind::BoundedBuffer(_)
                | PortOptionKind::Retry(_)
                | PortOptionKind::Resend(_)
                | PortOptionKind::Penalty { .. }
                | PortOptionKind::Rate(_)
                | PortOptionKind::Latest => {}
            }
        }
    }
    for variable in &task.variables {
        variable.names.iter().for_each(&mut *see);
        type_name(&variable.of, see);
    }
    for handler in &task.handlers {
        match &handler.trigger {
            Trigger::Message { port, variables, .. } => {
                [port].into_iter().chain(variables).for_each(&mut *see);
            }
            Trigger::Silence { port, when, .. } => {
                see(port);
                when.iter().for_each(|of| expr(of, see));
            }
            Trigger::Expiry(timer) => see(timer),
            Trigger::Fence => {}
        }
        statements(&handler.body, see);
    }
    statements(&task.body, see);
    task.takeover.iter().for_each(|body| statements(body, see));
}

fn statements<'f>(body: &'f [Statement], see: &mut dyn FnMut(&'f Name)) {
    for statement in body {
        of_statement(&statement.kind, see);
        statement.branches.iter().for_each(|branch| statements(&branch.body, see));
    }
}

fn of_statement<'f>(kind: &'f StatementKind, see: &mut dyn FnMut(&'f Name)) {
    match kind {
        StatementKind::Send { port, arguments, into, .. } => {
            see(port);
            arguments.iter().for_each(|of| expr(of, see));
            places(into, see);
        }
        StatementKind::Receive { port, into, from, .. } => {
            port.iter().chain(from).for_each(&mut *see);
            places(into, see);
        }
        StatementKind::Reply { port, arguments, asker, ticket, .. } => {
            port.iter().chain(asker).for_each(&mut *see);
            arguments.iter().chain(ticket).for_each(|of| expr(of, see));
        }
        StatementKind::Waitfor { port, arguments, .. } => {
            see(port);
            arguments.iter().for_each(|of| expr(of, see));
        }
        StatementKind::Order(names) => names.iter().for_each(see),
        StatementKind::Run { action, arguments, into, range, .. } => {
            see(action);
            arguments.iter().for_each(|of| expr(of, see));
            places(into, see);
            range.iter().flat_map(|(least, most)| [least, most]).for_each(|of| expr(of, see));
        }
        StatementKind::Start { timer, .. } | StatementKind::Stop(timer) => see(timer),
        StatementKind::Atomic(body) | StatementKind::Loop(body) => statements(body, see),
        StatementKind::Assign { place, value } => {
            place.path.iter().for_each(&mut *see);
            expr(value, see);
        }
        StatementKind::If { arms, otherwise } => {
            for (condition, body) in arms {
                expr(condition, see);
                statements(body, see);
            }
            otherwise.iter().for_each(|body| statements(body, see));
        }
        StatementKind::While(condition, body) => {
            expr(condition, see);
            statements(body, see);
        }
        StatementKind::Assert(of) => expr(of, see),
        StatementKind::Delay(_) | StatementKind::Exit | StatementKind::Skip | StatementKind::Abort(_) => {}
    }
}

fn places<'f>(places: &'f [Place], see: &mut dyn FnMut(&'f Name)) {
    places.iter().flat_map(|place| &place.path).for_each(see);
}

fn expr<'f>(of: &'f Expr, see: &mut dyn FnMut(&'f Name)) {
    match &of.kind {
        ExprKind::Bool(_) | ExprKind::Int(_) | ExprKind::Real(_) => {}
        ExprKind::Path(place) => place.path.iter().for_each(see),
        ExprKind::Call { of, argument } => of.path.iter().chain([argument]).for_each(see),
        ExprKind::Not(of) | ExprKind::Negate(of) | ExprKind::Trunc(of) => expr(of, see),
        ExprKind::Binary(_, left, right) => [left, right].into_iter().for_each(|of| expr(of, see)),
    }
}
