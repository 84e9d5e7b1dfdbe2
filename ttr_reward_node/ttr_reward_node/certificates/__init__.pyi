from .drives import drive as drive
