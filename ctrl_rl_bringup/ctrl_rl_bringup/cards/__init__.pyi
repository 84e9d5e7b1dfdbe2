from .zoo import zoo_pages as zoo_pages
