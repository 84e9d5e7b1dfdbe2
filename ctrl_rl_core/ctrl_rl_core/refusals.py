"""One-line reasons for command lines that tyro refuses."""

from __future__ import annotations

from tyro._errors import (
    BadValue,
    InstantiationFailure,
    InvalidChoice,
    MissingArgs,
    MissingSubcommand,
    ParseErrorEvent,
    UnrecognizedArgs,
)


def reason_of(event: ParseErrorEvent) -> str:
    """Return the reason for a refused command line as one line, or "" if tyro prints its own."""
    match event:
        case MissingArgs(missing_arguments=missing, unrecognized_tokens=[]):
            return f"missing {', '.join(each.arg.display_name() for each in missing)}"
        case MissingArgs(unrecognized_tokens=tokens) | UnrecognizedArgs(tokens=tokens):
            return f"unknown {'option' if tokens[0].startswith('-') else 'argument'} {tokens[0]}"
        case InvalidChoice(argument=argument, value=value, choices=choices):
            return f"{argument.display_name()} {value}: choose from {', '.join(choices)}"
        case MissingSubcommand(subcommand_spec=spec, found_token=found):
            names = ", ".join(spec.parser_from_name)
            return f"unknown command {found}: choose from {names}" if found else f"give one of: {names}"
        case BadValue(argument=argument):
            return f"{argument.display_name()} needs a value"
        case InstantiationFailure(message=message, argument=argument):
            reason = _last_reason(message)
            return f"{argument.display_name()} {reason}" if argument else reason
    return ""


def _last_reason(message: str) -> str:
    """Return the last reason in a message; for an optional option, tyro prints one line per type."""
    *before, last = message.strip().splitlines()
    return last.rpartition("]: ")[2] if before else last
