"""What is finished, kept on the disk as it comes, so that an interrupted run goes on."""

from greybox.journal.journal_file import JournalContent, add_entry, read_journal

__all__ = ["JournalContent", "add_entry", "read_journal"]
